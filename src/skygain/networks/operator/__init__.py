"""The propagation operator: the network and the small ones that find the transmitter."""
