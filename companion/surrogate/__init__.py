"""The paper's cost, its differentiable surrogates, their training, and the convergence theorem."""
