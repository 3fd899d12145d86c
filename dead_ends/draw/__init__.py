"""Results in, pictures out: maps, boundaries, animations, the report page.

geometry   cells, colors and outlines of a model's geometry
pictures   the map of a model, the boundaries of its critics
animation  episodes side by side
page       one self-contained page about a model
"""
