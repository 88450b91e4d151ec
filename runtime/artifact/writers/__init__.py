"""Writers: what other tools mean by the files that they write.

A tool's export and its import need not agree (Norse misreads its own files), and some of what a
network does is in no file. Each writer translates a graph into one with the author's meaning, under
a convention that names what was assumed; WRITERS is where a new one is entered.

writer           the table, the class, and the steps that the tools' files are read by
torch_tools      Norse, snnTorch, SpikingJelly
chip_tools       Lava, Rockpool, sinabs
"""
