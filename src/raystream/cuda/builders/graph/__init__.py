"""Builder of the sector graph on the device, bit-identical to the CPU's."""
