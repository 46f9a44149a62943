"""What is learnt from the expert."""
