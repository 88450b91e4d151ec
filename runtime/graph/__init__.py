"""The NIR graph: its neurons, its edges, its shapes, and whether it is sound.

nesting          Graphs inside graphs, taken apart: the same network in one level
neurons          The difference equation that a NIR neuron becomes under a convention
order            The order in which the nodes of a graph are computed, and which edges look bac
ports            The ports of a graph: its Input and Output nodes, side by side as the axes of
shapes           The shapes of a graph, walked along its edges: what each node takes and what i
validate         Soundness: what must be true of a NIR graph before anything is computed with i
windows          Windows: where the kernel of a convolution or of a pool is laid, axis by axis
"""
