"""The NIR graph: what its nodes compute, in which order, on which shapes, and whether it is valid.

The float model and the compiler both start from here, so that they agree on every neuron's
coefficients and every edge's delay.

neurons          the difference equation of a NIR neuron, and the timestep that its gains imply
numbers          parameters in whole numbers, as floats
sigma_delta      sigma-delta neurons: what the metadata say of a node `I`
windows          geometry of convolutions and pools
shapes           the shapes of every node, and the work of a timestep
order            execution order, late edges and delays in timesteps
ports            Input and Output nodes, and their rasters side by side
validate         checks of a whole graph: names, nodes, edges, ports
nesting          graphs nested in graphs, flattened
"""
