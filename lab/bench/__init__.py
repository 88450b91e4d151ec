"""Speed of this code, some of it beside other libraries.

latency      one action, against snnTorch's loop
convolutions convolutions on Speck and Loihi, against sinabs, snnTorch and Norse
runtime      batches of one and of many, against snnTorch, Norse, SpikingJelly and xylosim
nets, peers  the networks that `runtime` runs, and the libraries that run them
updates      training updates through each chip, against snnTorch's own
versions     this tree against another one
turns        candidates that take turns on a machine that does other things too
"""
