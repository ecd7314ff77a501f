"""What did we find? Pages over the record of trials."""
