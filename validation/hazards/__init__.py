"""Judgement of one simulated drive from truth alone: contacts in 3-D, near misses, avoidability, false stops."""
