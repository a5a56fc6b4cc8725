"""The experiments of Li, Liu, Tsui and Wang (2020), and checks of what they rest on; each has a `run`.

kite, multi_domain, cuboid, human: bodies that were in no training set. stability: error against noise. forward: the
far field against a finite element solution. kite_fem: the kites again, learned from finite element data.
"""

from __future__ import annotations
