"""Parts of controllers that several bases share."""
