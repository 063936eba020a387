"""How a study is done: runs in chunks, on the processes of this machine or on a cluster, each chunk
kept as soon as it is there.
"""
