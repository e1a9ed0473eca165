"""Setup of the machine: values that are shown and edited, and their versions."""
