"""Plots: what is drawn, and how Plotly draws it; tables and figures of notebooks."""
