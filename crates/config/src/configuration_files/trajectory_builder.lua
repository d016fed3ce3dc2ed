-- One trajectory: local SLAM of both dimensions; map_builder says which one runs.

include "trajectory_builder_2d.lua"
include "trajectory_builder_3d.lua"

TRAJECTORY_BUILDER = {
  trajectory_builder_2d = TRAJECTORY_BUILDER_2D,
  trajectory_builder_3d = TRAJECTORY_BUILDER_3D,
  -- Add pure_localization_trimmer = { max_submaps_to_keep = 3 } to localise in a loaded map.
  collate_fixed_frame = true,
  collate_landmarks = false,
}
