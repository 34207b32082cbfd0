"""Analysis of solved samples: networks of slipless contacts, rigid domains, bottlenecks, histograms, statistics.

Nothing here needs Taichi; results of any method are accepted.
"""
