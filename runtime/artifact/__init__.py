"""The artifact: one `.nir` file with network, codec, convention and provenance.

The only place that reads or writes `.nir`; files of other tools are read too, with an inferred dt
or as another tool reads them.

artifact         the artifact, loading, saving, and its digest
hdf5             the graph in an HDF5 container, checked and read node by node
nir_data         recorded spikes as other tools exchange them
"""
