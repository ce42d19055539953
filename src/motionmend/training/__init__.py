"""The loop: a network, corpora and settings become a run that can be killed and resumed bit for bit.

In: `Settings` and a folder. Out: checkpoints, logs and the exported network. It may ask the benchmark for
validation; it must not know the command line, nor be needed by anything that runs without torch.
"""
