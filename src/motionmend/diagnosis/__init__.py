"""Damage found: what is wrong with a take, how certain that is, and which samples not to trust.

In: a take. Out: a `Diagnosis`: findings, a mask, and for some of them how to undo the harm without a guess. It may try
fills to see what fits better; it must not know how gaps are filled in the end, nor reports.
"""
