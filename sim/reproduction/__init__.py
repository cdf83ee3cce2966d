"""The paper's experiments again, each number measured when it is run: `sim reproduce`."""
