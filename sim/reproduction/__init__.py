"""`sim reproduce`: runs the paper's experiments again and measures every number anew."""
