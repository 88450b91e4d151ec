"""The design rules: what fits on a chip, and how its cores take the layers of a network.

A rule is a function of a network that is placed on a chip; it yields what it found, the limit and a
remedy.

table            all rules by name, and what they say of a network
rule             what a rule is given and what it says
node_rules       rules on single nodes: kinds, resets, decays, thresholds, weights, kernels
capacity_rules   rules on layers and networks: neurons, synapses, memory, axons, cores, chips
mapping          populations on cores, and how full those are
core_memory      what the synapses of a block of neurons take of a core
topology         populations of neurons, and the projections between them
fan              how many synapses leave and reach each neuron of a projection
"""
