-- Runs in every new interpreter before the configuration, whose libraries are `table`, `string`, `math`, `bit32` and
-- `coroutine`. Takes away what is left of files and byte code. Called with a function that takes a line of output.

local output = ...

local function refuse(name)
  return function()
    error(name .. " is not available in a configuration: files are read with include and read", 2)
  end
end

-- Whatever is asked of these libraries is refused by its name.
local function refuse_library(name)
  return setmetatable({}, {
    __index = function(_, key) return refuse(name .. "." .. tostring(key)) end,
    __newindex = refuse(name),
    __metatable = false,
  })
end

local function join(...)
  local parts = table.pack(...)
  for i = 1, parts.n do parts[i] = tostring(parts[i]) end
  return parts
end

print = function(...) output(table.concat(join(...), "\t")) end

os, io, package, debug = refuse_library("os"), refuse_library("io"), refuse_library("package"), refuse_library("debug")
dofile, loadfile, require = refuse("dofile"), refuse("loadfile"), refuse("require")

local load_chunk = load
load = function(chunk, name, _, ...)
  if select("#", ...) > 0 then return load_chunk(chunk, name, "t", (...)) end
  return load_chunk(chunk, name, "t")
end
if loadstring then loadstring = load end
