"""Instructions and bytes of exported C on emulated microcontrollers; C sources are in c/."""
