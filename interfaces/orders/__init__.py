"""Orders of operators: signatures, sequence numbers, and the gate that only verified orders pass."""
