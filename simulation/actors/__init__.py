"""People, animals and vehicles and their encounters with the machine."""
