"""The graph of sectors, built on the device with the CPU's bits."""
