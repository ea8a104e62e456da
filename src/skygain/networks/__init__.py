"""What a trained network is: its inputs, its definition, its weights."""
