"""kd-trees grown on the device, level by level, with the CPU's planes."""
