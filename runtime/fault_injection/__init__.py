"""`headland campaign faults`: everything that can break, broken in every situation, and judged."""
