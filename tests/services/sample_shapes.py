"""A function with a behaviour, for tests of stages: named by study files as `sample_shapes:shape`."""


def shape(params, avoid=None):
    """Left or right of 0.5 are two strategies; whoever is told what is known finds what lies beyond it."""
    x = params["x"]
    side = 0.0 if x < 0.5 else 1.0
    if avoid is not None:
        side = 2.0 + float(max(avoid)[0])
    return x, [side]
