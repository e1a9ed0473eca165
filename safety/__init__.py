"""The supervisor: modes, stopping distance, protective field, rules. It alone builds safe commands."""
