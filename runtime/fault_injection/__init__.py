"""`headland campaign fault-injection`: injects each fault in each situation and evaluates the reaction."""
