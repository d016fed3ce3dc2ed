-- Shows a map without changing it: no constraint is sought, nothing is optimised.

include "backpack_2d.lua"

POSE_GRAPH.constraint_builder.sampling_ratio = 0
POSE_GRAPH.global_sampling_ratio = 0
POSE_GRAPH.optimize_every_n_nodes = 0

return options
