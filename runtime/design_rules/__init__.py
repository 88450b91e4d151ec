"""The design rules: what a chip has room for, and the mapping of layers onto its cores.

capacity_rules   Design rules on how much a layer takes: neurons, synapses, memory and axons of
core_memory      The load of a core: what the synapses of a block of neurons take
fan              Fans: how many synapses leave each source and reach each target of a map witho
mapping          The mapping of a network onto the cores of a chip
node_rules       Design rules on what a single node is: its kind, its neurons' parameters, its
placed           The design: a network on a chip, which is what design rules judge
result           The ruling: what one design rule says of one node, or of the whole network
table            The design rules: a table of them, and what they say of a network on a chip
topology         The topology of a graph: its populations of neurons, and the synapses between
"""
