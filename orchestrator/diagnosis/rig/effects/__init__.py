"""The effects that come with the product."""
