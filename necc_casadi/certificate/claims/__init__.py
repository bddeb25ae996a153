"""What maker and checker share: claims, regions and words, as data."""
