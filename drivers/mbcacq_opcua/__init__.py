"""Joint angles by OPC UA, from controllers that serve the nodes of its companion specification for robots. Nothing is written to them."""
