"""From raw takes to arrays to train on: data sets read, joints mapped, frames resampled, splits kept.

In: a folder as its publisher made it. Out: a `Corpus`, the same bytes every time. A data set is one file in `datasets`.
It must not know how anything is repaired, trained or measured.
"""
