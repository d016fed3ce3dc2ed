//! The Lua dialect: functions, limits, messages.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use std::time::{Duration, Instant};

use portolan_config::lua::{Evaluation, Limits, evaluate_file, evaluate_text};
use portolan_config::{ConfigError, Value};

fn run_for(milliseconds: u64, text: &str) -> Result<Evaluation, ConfigError> {
    let limits = Limits { time: Duration::from_millis(milliseconds), memory: 32 << 20 };
    evaluate_text("test.lua", text, &[], limits)
}

fn run(text: &str) -> Result<Evaluation, ConfigError> {
    run_for(5000, text)
}

fn value(expression: &str) -> Value {
    run(&format!("return {{ {expression} }}")).unwrap().table.array[0].clone()
}

fn message(text: &str) -> String {
    run(text).unwrap_err().to_string()
}

#[test]
fn choose_takes_a_boolean_and_two_values() {
    assert_eq!(value("choose(true, 1, 0)"), Value::Number(1.0));
    assert_eq!(value("choose(false, 1, 0)"), Value::Number(0.0));
    assert!(
        message("x = 1\nreturn { choose('truish', 1, 0) }").contains("condition is not a boolean value.")
    );
    assert!(message("return { choose(true, 1) }").starts_with("test.lua:1: choose needs 3 arguments"));
}

#[test]
fn the_language_is_lua_5_2() {
    assert_eq!(value("_VERSION"), Value::Text("Lua 5.2".into()));
    assert_eq!(value("math.rad(180) == math.pi and math.huge > 1e308"), Value::Boolean(true));
    assert_eq!(value("10 / 4"), Value::Number(2.5));
    assert_eq!(value("unpack == nil and table.unpack ~= nil and load('return 7')()"), Value::Number(7.0));
    assert_eq!(value("bit32.band(6, 3); 5, 'separated by both'"), Value::Number(2.0));
    assert_eq!(value("setmetatable({}, { __index = function() return 1 end }).x"), Value::Number(1.0));
}

#[test]
fn the_last_returned_value_must_be_a_table() {
    for (text, found) in [("x = 1", "nothing"), ("return 5", "number"), ("return {}, nil", "nil")] {
        let error = run(text).unwrap_err();
        assert!(matches!(&error, ConfigError::NotATable { found: f, .. } if f == found), "{error}");
        assert!(error.to_string().contains("Topmost item on Lua stack is not a table!"));
    }
    assert_eq!(run("return 1, { 2 }").unwrap().table.array, [Value::Number(2.0)]);
}

#[test]
fn includes_share_globals_and_return_values() {
    let directory = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(directory.path().join(name), text).unwrap();
    write("part.lua", "SHARED = (SHARED or 0) + 1\nreturn 10, 20");
    write("main.lua", "local a, b = include \"part.lua\"\nreturn { a, b, SHARED, text = read \"note.txt\" }");
    write("note.txt", "a note\n");
    write("twice.lua", "include 'part.lua'\n\ninclude 'part.lua'\nreturn {}");
    write("outer.lua", "include 'faulty.lua'\nreturn {}");
    write("faulty.lua", "-- a comment\nlocal x = nothing.field\n");
    write("self.lua", "if not SEEN then SEEN = true; include 'self.lua' end\nreturn { seen = SEEN }");
    let run = |name: &str| evaluate_file(&directory.path().join(name), &[], Limits::default());

    let main = run("main.lua").unwrap();
    assert_eq!(main.table.array, [10.0, 20.0, 1.0].map(Value::Number));
    assert_eq!(main.table.entries["text"], Value::Text("a note\n".into()));
    assert_eq!(main.files.len(), 2);

    let twice = run("twice.lua").unwrap_err().to_string();
    assert!(twice.contains("twice.lua:3: Tried to include ") && twice.contains("part.lua twice."), "{twice}");
    assert!(twice.contains("Already included files in order of inclusion: "), "{twice}");

    let ConfigError::Lua { place: Some(place), message, .. } = run("outer.lua").unwrap_err() else {
        panic!("an error of Lua expected")
    };
    assert!(place.file.ends_with("faulty.lua") && place.line == Some(2), "{place}");
    assert!(message.contains("attempt to index global 'nothing'"), "{message}");
    assert_eq!(run("self.lua").unwrap().table.entries["seen"], Value::Boolean(true));
}

#[test]
fn a_file_that_is_not_there_is_named_with_the_places_searched() {
    let error = run("local x = 1\ninclude \"pose_grap.lua\"\nreturn {}").unwrap_err();
    let ConfigError::FileNotFound { name, place: Some(place), .. } = &error else { panic!("{error}") };
    assert_eq!((name.as_str(), place.line), ("pose_grap.lua", Some(2)));
    assert!(
        error.to_string().contains("File 'pose_grap.lua' was not found.")
            && error.to_string().contains("`pose_graph.lua`?"),
        "{error}"
    );
    assert!(message("read ''").contains("File '' was not found."));
    assert!(message("include()").contains("include needs exactly one string"));
    assert!(message("include({})").contains("include needs exactly one string"));
    let missing = evaluate_file("/nowhere/backpack_2d.lua".as_ref(), &[], Limits::default()).unwrap_err();
    assert!(matches!(missing, ConfigError::Unreadable { .. }), "{missing}");
}

#[test]
fn faults_are_reported_with_file_and_line() {
    assert!(message("x = {\n  a = 1,,\n}").starts_with("test.lua:2: "));
    assert!(message("\n\nerror('stop here')").starts_with("test.lua:3: stop here"));
    assert!(message("return POSE_GRAPH.x").contains("is an include"));
    assert!(message("SPARSE_POSE_GRAPH.x = 1").contains("is POSE_GRAPH now"));
    assert!(message("error({})").starts_with("test.lua: "));
    assert!(message("error()").starts_with("test.lua: "));
}

#[test]
fn endless_configurations_are_stopped() {
    for text in [
        "while true do end",
        "while true do pcall(function() while true do end end) end",
        "coroutine.wrap(function() while true do end end)()",
        "local c = coroutine.create(function() while true do pcall(error) end end) coroutine.resume(c)\nwhile true do end",
        "setmetatable({}, { __gc = function() while true do end end }) collectgarbage() return {}",
        "return { string.find(('a'):rep(100000), ('.-'):rep(20) .. 'b') }",
        "local function f() return f() end f()",
    ] {
        let start = Instant::now();
        let error = run_for(100, text).unwrap_err();
        assert!(matches!(error, ConfigError::Limit { .. }), "{text}: {error}");
        assert!(start.elapsed() < Duration::from_secs(5), "{text}");
    }
    let error = run_for(100, "local x\nwhile true do\nend").unwrap_err().to_string();
    assert!(error.starts_with("test.lua:2: the configuration was stopped"));
}

#[test]
fn memory_and_depth_are_limited() {
    for text in [
        "local t = {} while true do t[#t + 1] = ('x'):rep(1000) .. #t end",
        "return { ('x'):rep(1e9) }",
        "local s = 'x' while true do s = s .. s end",
        "local t = {} t.t = t return t",
        "local t = {} for i = 1, 40 do t = { t, t } end return t",
        "local s, t = ('x'):rep(1e7), {} for i = 1, 100 do t[i] = s end return t",
        "local t, u = { [('x'):rep(1e6)] = 1 }, {} for i = 1, 200 do u[i] = t end return u",
        "local function f() return 1 + f() end f()",
    ] {
        assert!(run(text).is_err(), "{text}");
    }
    let deep = format!("return {}{}", "{".repeat(150), "}".repeat(150));
    assert!(message(&deep).contains("nested deeper"));
    let deeper = format!("return {}{}", "{".repeat(100_000), "}".repeat(100_000));
    assert!(run(&deeper).is_err());
}

#[test]
fn the_process_and_its_output_are_out_of_reach() {
    for text in [
        "os.exit(1)",
        "os.execute('true')",
        "io.popen('true')",
        "os.remove('x')",
        "io.open('x', 'w')",
        "io.read()",
        "io.write('x')",
        "io.open('/etc/hostname')",
        "io.lines('/etc/hostname')",
        "os.getenv('HOME')",
        "os.time()",
        "os.x = 1",
        "package.path = 'x'",
        "loadfile('/etc/hostname')",
        "dofile()",
        "assert(load(string.dump(function() end)))",
        "require 'socket.core'",
        "debug.getinfo(1)",
        "package.loadlib('x', 'y')",
    ] {
        assert!(run(&format!("{text}\nreturn {{}}")).is_err(), "{text}");
    }
    let refused = run("os.getenv('HOME')\nreturn {}").unwrap_err().to_string();
    assert!(refused.contains("os.getenv is not available in a configuration"), "{refused}");
    let printed = run("print('a', 1, nil)\nprint('b' .. 2)\nreturn {}").unwrap().printed;
    assert_eq!(printed, ["a\t1\tnil", "b2"]);
    assert_eq!(run("for i = 1, 5000 do print(i) end return {}").unwrap().printed.len(), 1000);
}

#[test]
fn includes_are_bounded() {
    let directory = tempfile::tempdir().unwrap();
    let at = |i: usize| directory.path().join(format!("{i}.lua"));
    for i in 0..120 {
        std::fs::write(at(i), format!("return include \"{}.lua\"", i + 1)).unwrap();
    }
    let error = evaluate_file(&at(0), &[], Limits::default()).unwrap_err().to_string();
    assert!(
        error.contains("more than 100 files are included") || error.contains("stack overflow"),
        "{error}"
    );
    // One large file by many names.
    std::fs::write(at(0), format!("--{}\nreturn {{}}", "x".repeat(9 << 20))).unwrap();
    let names = (1..=5).map(|i| format!("include \"{}0.lua\"\n", "./".repeat(i)));
    std::fs::write(at(1), names.collect::<String>() + "return {}").unwrap();
    let error = evaluate_file(&at(1), &[], Limits::default()).unwrap_err().to_string();
    assert!(error.contains("1.lua:4: ") && error.contains("larger than 32 MiB"), "{error}");
}

#[test]
fn bytes_that_are_no_utf8_are_allowed_in_comments_and_errors_in_values() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("gbk.lua");
    std::fs::write(&path, b"-- \xb2\xe2\xca\xd4\nreturn { a = 1 }").unwrap();
    assert_eq!(evaluate_file(&path, &[], Limits::default()).unwrap().table.entries.len(), 1);
    std::fs::write(&path, b"return { a = { b = '\xb2' } }").unwrap();
    let error = evaluate_file(&path, &[], Limits::default()).unwrap_err().to_string();
    assert!(error.contains("a.b: the string is not UTF-8"), "{error}");
    std::fs::write(&path, b"\x1bLua\x52\x00\x01").unwrap();
    assert!(evaluate_file(&path, &[], Limits::default()).is_err());
}
