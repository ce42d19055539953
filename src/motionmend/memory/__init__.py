"""Takes that teach: a gap is filled by what the most similar stretches of other takes did beyond their own curves.

In: takes, and a motion or a rig with gaps. Out: the gaps that could be answered, and from which takes. Windows of takes
are compared as they are, by joints' or markers' names; no body is needed. It must not know reports or the command line.
"""
