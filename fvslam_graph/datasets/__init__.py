"""Published recordings: which there are, and how they come here."""
