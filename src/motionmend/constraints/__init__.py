"""What every answer owes the take: no pop at the seams, bones of one length, feet that stand still, given paths met.

In: an answer, what was before it, and where it may change. Out: the answer mended, or checks with numbers. Nothing here
changes a sample outside the mask it is given, and nothing knows who gave the answer.
"""
