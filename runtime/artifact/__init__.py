"""The artifact: one `.nir` file with network, codec, convention and provenance.

The only place that reads or writes `.nir`; files of other tools are read too, with an inferred dt
or as another tool reads them.

artifact         the artifact, loading, saving, and its digest
hdf5             the graph in an HDF5 container, read node by node
hdf5_limits      what a container may hold and unpack to, checked before it is read
batch_axis       shapes that some tools write with a batch of one
nir_data         recorded spikes as other tools exchange them
presets/         how other tools read the same file
writers/         what other tools mean by the files that they write
"""
