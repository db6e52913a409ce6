"""Builder of kd-trees on the device, level by level, with the CPU's planes."""
