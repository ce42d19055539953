"""Whose joints these are: BODY's 21 joints, and which joint of any rig is which of them.

In: names, parents and positions in any units and axes. Out: a `Mapping`, a person's stature, which way is up, where
the body faces, and which distances stay. Knows arrays and names; it must not know files, damage or fills.
"""
