"""Which poses are natural? A variational autoencoder of captured poses; nothing of tasks or rewards."""
