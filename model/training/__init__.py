"""What every training shares, a lab's and that of the shipped model."""
