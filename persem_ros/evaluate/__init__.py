"""The evaluation: recordings with truth become the paper's tables, figures and intervals."""
