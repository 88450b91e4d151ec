"""Instructions and bytes of exported C on emulated microcontrollers; C sources are in c/.

policies       shipped policies, spiking and float
peers          float policies through emlearn, beside ours
integers       float policies in integers, beside ours
networks       networks through snn-mlir and LLVM, beside ours
targets        building for a target, running in QEMU, counting
table          the tables of results/firmware.md, and the options of all commands
dense          dense networks as C, by us and by emlearn
snn_to_linalg  the operations of snn-mlir in MLIR's own dialects
"""
