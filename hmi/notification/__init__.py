"""Notifications to a person who is not at the page: when the machine stands and needs somebody."""
