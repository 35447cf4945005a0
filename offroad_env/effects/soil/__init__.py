"""Laws of soil under a wheel, and what is uncertain about its parameters or those of hard ground."""
