"""The paper's studies repeated; nothing below knows of them."""
