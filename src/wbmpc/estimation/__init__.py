"""Estimators that several bases share."""
