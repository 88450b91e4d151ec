"""The artifact: one `.nir` file, read and written, with what other tools make of it.

artifact         The artifact: one `.nir` file that is all a robot needs. The only reader and w
hdf5             The HDF5 container of a NIR file: what must be true of its tree before anythin
infer_dt         The timestep that a file was written with, where NIR leaves it out but the gai
presets/         what other tools make of the same file; a tool, a file.
"""
