"""Studies: experiments over settings, seeds and robots on many processes, their statistics and pages, and the search of settings.

What a file says (``definition``) becomes combinations of settings (``plan``), whose runs (``work``) are done by Dask's workers
(``workers``) and kept as rows (``store``); ``summary`` and ``statistics`` read the rows, ``page`` draws them. ``tuning`` asks Optuna
for settings and makes rows of its trials. :class:`wbmpc.study.study.Study` has all of it.
"""
