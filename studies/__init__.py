"""Evidence about ullage: its radar against theory and recordings, the thesis' experiments, what breaks each statement.

It lies beside the package in the source tree and is not installed with it. `ullage validate` and `ullage reproduce`
load it.
"""
