-- Runs in every new interpreter before the configuration. Takes away what a configuration may not do:
-- end the process, write to the program's output, wait for input, start programs, change files, load
-- byte code. Called with a function that takes a line of output.

local output = ...

local function refuse(name)
  return function()
    error(name .. " is not available in a configuration", 2)
  end
end

local function join(...)
  local parts = table.pack(...)
  for i = 1, parts.n do parts[i] = tostring(parts[i]) end
  return parts
end

print = function(...) output(table.concat(join(...), "\t")) end

for _, name in ipairs { "exit", "execute", "remove", "rename", "tmpname", "setlocale" } do
  os[name] = refuse("os." .. name)
end
for _, name in ipairs { "popen", "tmpfile", "output", "input", "read", "lines" } do
  io[name] = refuse("io." .. name)
end
io.stdin, io.stdout, io.stderr = nil, nil, nil
io.write = function(...) output(table.concat(join(...))) end
local open = io.open
io.open = function(name, mode)
  if mode ~= nil and mode ~= "r" and mode ~= "rb" then
    error("files can only be opened for reading in a configuration", 2)
  end
  return open(name, "rb")
end

local load_chunk, load_file = load, loadfile
load = function(chunk, name, _, ...)
  if select("#", ...) > 0 then return load_chunk(chunk, name, "t", (...)) end
  return load_chunk(chunk, name, "t")
end
if loadstring then loadstring = load end
loadfile = function(name, _, ...)
  if type(name) ~= "string" then error("loadfile needs the name of a file", 2) end
  if select("#", ...) > 0 then return load_file(name, "t", (...)) end
  return load_file(name, "t")
end
dofile = function(name)
  local chunk, message = loadfile(name)
  if not chunk then error(message, 2) end
  return chunk()
end

package.loadlib = nil
local searchpath = package.searchpath
local searchers = package.searchers
for i = #searchers, 3, -1 do searchers[i] = nil end
searchers[2] = function(name)
  local path, message = searchpath(name, package.path)
  if not path then return message end
  local chunk, problem = loadfile(path)
  if not chunk then error(problem, 2) end
  return chunk, path
end
