"""The soil under a recorded drive: a joint posterior of its parameters under several structures."""
