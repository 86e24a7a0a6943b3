"""The page that plays recorded flights back."""
