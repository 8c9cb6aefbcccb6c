"""Recommends television programmes: guide, tastes, ratings, presentation."""
