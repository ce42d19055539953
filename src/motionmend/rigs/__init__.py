"""From positions to a rig's channels: joints aimed, a rig fitted, one pose held and posed anew.

In: a take with a rig, and where its joints ought to be, in metres. Out: the take with other turns and shifts, its bones
as long as they were. It must not know files, gaps or why anything moves.
"""
