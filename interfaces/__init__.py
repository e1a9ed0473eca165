"""Everything that speaks a foreign format or drives a device: buses, receivers, the gateway to the machine."""
