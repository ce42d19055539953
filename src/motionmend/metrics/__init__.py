"""Errors as plain functions of arrays: of positions, of rotations, and of many samples of one truth.

In: arrays `(frames, joints, …)` in metres, and masks. Out: numbers in the unit that each function names. It must not
know takes, methods or tables: those ask it.
"""
