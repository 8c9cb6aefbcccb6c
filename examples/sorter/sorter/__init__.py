"""An arm that sorts what comes along a belt: components, and the world they meet."""
