"""Messages between nodes, topic table, node interface, faults and errors."""
