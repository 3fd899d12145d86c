"""Results in, pictures out: maps, boundaries, animations, a page about a model.

palette    one color, one meaning
geometry   cells, places and outlines of a model's geometry
pictures   the map of a model, the boundaries of its critics
animation  episodes side by side
page       one self-contained page about a model
"""
