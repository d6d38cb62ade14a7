"""The client of MOM, message-oriented middleware for robots."""
