"""The effects that come with the product, one a file."""
