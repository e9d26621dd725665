"""The physics engines that come with NMES. They are found by entry point, as anybody's are, never imported."""
