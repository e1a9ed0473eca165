"""External protocols and devices: buses, receivers, and the gateway to the machine."""
