"""What Table I measures: every knob that the paper leaves open, varied, and what becomes of each of its 32 rows.

``knobs`` has the knobs and their values, ``cameras`` the published views, ``plan`` what is measured, ``measure`` the counts,
and ``analysis`` and ``fit`` what follows from them. ``python -m nptrace.table1_study`` writes one table of counts.
"""
