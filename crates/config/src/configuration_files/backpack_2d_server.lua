-- A server for several 2D backpacks.

include "map_builder_server.lua"

MAP_BUILDER_SERVER.map_builder.use_trajectory_builder_2d = true

return MAP_BUILDER_SERVER
