"""A network as a Completer: windows of a take into a space, through a graph, and back onto the take.

In: a motion with gaps, or a checkpoint's folder. Out: the motion completed, or the exported graph. The networks
themselves stand in `models`, one file each. It must not know whether to ask one, or for
which gap: `repairs` does.
"""
