"""Instructions and bytes of exported C on emulated microcontrollers; C sources are in c/.

policies       shipped policies, spiking and float
peers          float policies through emlearn, beside ours
integers       float policies in integers, beside ours
networks       networks through snn-mlir, beside ours
runs, targets  building for a target, running in QEMU, counting
table          the tables of docs/firmware.md
dense          dense networks as C, by us and by emlearn
snn_mlir_code, snn_to_linalg  the same networks through snn-mlir and LLVM
"""
