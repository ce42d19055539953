"""Gaps filled by what stands beside them: curves over time, neighbours in space, for points and for channels.

In: a motion or a rig, and its gaps. Out: the same with the gaps written, and which method wrote what and why. `Auto`
chooses among the fills by gap and trial. It must not know files, networks or reports: `repairs` adds those.
"""
