"""What the multipass machine runs on the device, compiled from Python."""
