"""What a user asks for, and what carries it out."""
