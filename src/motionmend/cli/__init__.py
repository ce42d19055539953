"""The command line: a verb is one file, a dataclass whose fields are its options.

In: words that a person typed. Out: files, lines of text and an exit status. Every verb hands its work to a room above;
there is no arithmetic here, and nothing else may know this room.
"""
