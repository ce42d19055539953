"""The jobs `blend` and `chain`: parts of takes put together, what lies between them filled by `repairs`.

In: takes, with joints and frames. Out: one take on the first one's rig, and a report of the pieces. It must not know
corpora, benchmarks, or the job of `animation`.
"""
