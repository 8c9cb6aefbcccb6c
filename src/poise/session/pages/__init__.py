"""Pages and pictures of runs and placements as HTML and SVG."""
