"""Figures of a study for papers: vector files in the sizes and fonts of a two-column page.

They show what the pages show, from the same functions: surrogates and importances (`services.insight`), distinct
strategies (`services.report`), difficulties (`services.fidelity`), the course of the best value (`services.course`).
Drawing needs matplotlib (`pip install 'halma[plot]'`).

    from services.figures.shown import Shown
    from services.figures.study import draw

    figures = draw(Shown.of(store, "quickstart")).figures
"""
