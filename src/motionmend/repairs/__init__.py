"""The job `repair`: a damaged take in, the same take out, and a report of what was done.

Here the fills, the networks and their samples meet: the chooser takes one for each gap, constraints are paid, checks
made. Denoising, inspection, comparison and the demonstration stand beside it. It must not know corpora, benchmarks or
the command line.
"""
