"""What flows between the nodes: messages, the topic table, the node contract, faults and errors."""
