//! What is wrong in a model's file: every fault, with its place and its words.

use mom_rsp_model::{Fault, Model};

/// A model with these lines in its first element, which begin in line 5.
fn element(lines: &str) -> String {
    format!("name = \"cart\"\nid = 7\n[[element]]\nname = \"wheel\"\n{lines}\n")
}

fn check(text: &str, kind: Fault, place: (usize, usize), words: &str) {
    let error = Model::read(text).expect_err(text);
    let (line, column) = error.place();
    let found = error.to_string();
    let found = found
        .strip_prefix(&format!("line {line}, column {column}: "))
        .expect("the place comes first");
    assert_eq!(
        (error.fault(), (line, column), found),
        (kind, place, words),
        "{text}"
    );
}

fn in_element(lines: &str, kind: Fault, place: (usize, usize), words: &str) {
    check(&element(lines), kind, place, words);
}

const EFFECTOR: &str = "kind = \"effector\"\ntype = \"i16\"\n";

/// A line of an effector of type i16, which is line 7.
fn in_effector(line: &str, kind: Fault, column: usize, words: &str) {
    // Where a key is missing, the element is the place.
    let place = if column == 0 { (3, 1) } else { (7, column) };
    check(&element(&format!("{EFFECTOR}{line}")), kind, place, words);
}

#[test]
fn what_is_no_toml_is_refused_at_its_place() {
    let error = Model::read("name = = 1\n").unwrap_err();
    assert_eq!((error.fault(), error.place()), (Fault::Syntax, (1, 8)));
    let error = Model::read("name = \"ä\"\nname = \"b\"\n").unwrap_err();
    assert_eq!((error.fault(), error.place()), (Fault::Syntax, (2, 1)));
    let long = format!("# {}\n", "x".repeat(1 << 20));
    check(
        &long,
        Fault::TooLong,
        (1, 1),
        "1048579 bytes are too many: a model has at most 1048576",
    );
}

#[test]
fn unknown_keys_and_words_are_refused_with_the_nearest_known() {
    check(
        "nome = \"x\"\n",
        Fault::UnknownKey,
        (1, 1),
        "there is no key `nome`; did you mean `name`?",
    );
    in_element(
        "  knd = \"sensor\"",
        Fault::UnknownKey,
        (5, 3),
        "there is no key `knd`; did you mean `kind`?",
    );
    in_element(
        "kind = \"memory-comand\"",
        Fault::UnknownWord,
        (5, 8),
        "there is no kind of element `memory-comand`; did you mean `memory-command`?",
    );
    in_element(
        "kind = \"motor\"",
        Fault::UnknownWord,
        (5, 8),
        "there is no kind of element `motor`; expected one of `effector`, `sensor`, `monitor`, `command`, `module`, `event`, `memory-command`, `memory-event`",
    );
    in_element(
        "kind = \"sensor\"\ntype = \"ui16\"",
        Fault::UnknownWord,
        (6, 8),
        "there is no type `ui16`; did you mean `u16`?",
    );
    in_element(
        "kind = \"sensor\"\ntype = \"double\"",
        Fault::UnknownWord,
        (6, 8),
        "there is no type `double`; expected one of `u8`, `i8`, `u16`, `i16`, `u32`, `i32`, `f32`, `bytes`",
    );
    in_effector(
        "motion = \"absolut\"",
        Fault::UnknownWord,
        10,
        "there is no way of motion `absolut`; did you mean `absolute`?",
    );
}

#[test]
fn what_is_missing_is_named() {
    check("id = 1\n", Fault::MissingKey, (1, 1), "`name` is missing");
    check("name = \"x\"\n", Fault::MissingKey, (1, 1), "`id` is missing");
    check(
        "name = \"x\"\nid = 1\n",
        Fault::Elements,
        (1, 1),
        "the model has no element: write `[[element]]` for each",
    );
    in_element("", Fault::MissingKey, (3, 1), "`kind` is missing");
    in_element(
        "kind = \"sensor\"",
        Fault::MissingKey,
        (3, 1),
        "`type` is missing",
    );
    in_element("kind = \"monitor\"", Fault::MissingKey, (3, 1), "`of` is missing");
    in_element(
        "kind = \"module\"",
        Fault::MissingKey,
        (3, 1),
        "`members` is missing",
    );
    in_element(
        "kind = \"sensor\"\ntype = \"bytes\"",
        Fault::MissingKey,
        (3, 1),
        "`max` is missing",
    );
}

#[test]
fn values_of_another_type_are_refused() {
    for (text, place, words) in [
        ("name = 1\n", (1, 8), "expected a text, found an integer"),
        (
            "name = \"x\"\nid = \"1\"\n",
            (2, 6),
            "expected an integer, found a text",
        ),
        (
            "name = \"x\"\nid = 1.5\n",
            (2, 6),
            "expected an integer, found a number with a fraction",
        ),
        (
            "element = 1\n",
            (1, 11),
            "expected a list of tables, found an integer: write `[[element]]`",
        ),
        (
            "element = [1]\n",
            (1, 12),
            "expected a table, found an integer: write `[[element]]`",
        ),
    ] {
        check(text, Fault::Type, place, words);
    }
    in_effector(
        "interpolate = 1",
        Fault::Type,
        15,
        "expected true or false, found an integer",
    );
    in_effector(
        "range = 5",
        Fault::Type,
        9,
        "expected a list of two numbers, found an integer",
    );
    in_effector(
        "safe = 2020-01-01",
        Fault::Type,
        8,
        "expected a number, found a date",
    );
}

#[test]
fn numbers_outside_what_is_possible_are_refused() {
    check(
        "name = \"x\"\nid = 65536\n",
        Fault::Number,
        (2, 6),
        "`id` is 0 to 65535, and 65536 is not",
    );
    check(
        "name = \"x\"\nid = 1\nperiod = 0\n",
        Fault::Number,
        (3, 10),
        "`period` is 1 to 200, and 0 is not",
    );
    check(
        "name = \"x\"\nid = 1\nwatchdog = 39\n",
        Fault::Number,
        (3, 12),
        "a watchdog of 39 ms ends the session at one lost packet: set 0 for none, or at least two periods, 40 ms",
    );
    check(
        "name = \"x\"\nid = 1\nlargest-packet = 70_000\n",
        Fault::Number,
        (3, 18),
        "`largest-packet` is 64 to 65507, and 70000 is not",
    );
    in_effector(
        "count = 0",
        Fault::Number,
        9,
        "`count` is 1 to 65535, and 0 is not",
    );
    in_effector(
        "scale = 0",
        Fault::Number,
        9,
        "a scale is 1e-12 to 1e12, and 0 is not: the value in the unit is the wire's times it",
    );
    in_effector("scale = nan", Fault::Number, 9, "expected a finite number");
    in_effector(
        "rate = -1",
        Fault::Number,
        8,
        "a rate is in units per second and must exceed 0, not -1",
    );
    in_effector(
        "rate = 1\ncount = 2\nscale = [1, 2]",
        Fault::Number,
        8,
        "one rate cannot limit numbers of several scales: make them elements of their own",
    );
}

#[test]
fn names_that_are_no_words_are_refused() {
    for name in [
        "",
        "Left",
        "left wheel",
        "1st",
        "a--b",
        "a-",
        "-a",
        "ä",
        "a_b",
        &"a".repeat(49),
    ] {
        let text = element("kind = \"event\"").replace("wheel", name);
        let error = Model::read(&text).expect_err(name);
        assert_eq!((error.fault(), error.place()), (Fault::Name, (4, 8)), "{name}");
    }
    in_effector(
        "unit = \"°\"",
        Fault::Name,
        8,
        "`°` is not a unit: at most 16 letters, digits, `/`, `*`, `^` and `%`, as in `mm/s` or `m/s^2`",
    );
    let text = element("kind = \"event\"").replace("cart", "Cart");
    check(
        &text,
        Fault::Name,
        (1, 8),
        "`Cart` is not a name: lower-case letters and digits, a letter first, `-` between them, at most 48",
    );
}

#[test]
fn two_elements_of_one_name_are_refused() {
    let second = |name: &str| {
        element(&format!(
            "kind = \"event\"\n[[element]]\nname = \"{name}\"\nkind = \"event\""
        ))
    };
    check(
        &second("wheel"),
        Fault::NameTwice,
        (7, 8),
        "two elements have the name `wheel`",
    );
    check(
        &second("whe-el"),
        Fault::NameTwice,
        (7, 8),
        "`whe-el` and `wheel` have the same name in generated code",
    );
    in_effector(
        "parts = [\"x\", \"y\", \"x\"]",
        Fault::NameTwice,
        20,
        "two parts have the name `x`, or one that is the same in generated code",
    );
}

#[test]
fn ranges_and_safe_values_are_checked() {
    in_effector(
        "range = [5, -5]",
        Fault::Range,
        9,
        "the range is reversed: 5 is more than -5; the least value goes first",
    );
    in_effector(
        "range = [0, 40000]",
        Fault::Range,
        9,
        "0 to 40000 does not fit: i16 holds -32768 to 32767 at a scale of 1",
    );
    in_effector(
        "range = [1, 5]",
        Fault::Safe,
        0,
        "0 is outside the range, 1 to 5, so `safe` is required",
    );
    in_effector(
        "safe = 6\nrange = [1, 5]",
        Fault::Safe,
        8,
        "the safe value 6 is outside the range, 1 to 5",
    );
    in_effector(
        "safe = 6\nmotion = \"incremental\"",
        Fault::Safe,
        8,
        "the safe step of an incremental effector must be 0, not 6",
    );
    in_effector(
        "range = [[0, 5], [5, 0]]\ncount = 2",
        Fault::Range,
        18,
        "the range is reversed: 5 is more than 0; the least value goes first",
    );
}

#[test]
fn lists_have_as_many_values_as_there_are_numbers() {
    for (line, key, given, count) in [
        ("unit = [\"mm\", \"mm\"]\ncount = 3", "unit", 2, 3),
        ("scale = [1]\ncount = 3", "scale", 1, 3),
        ("safe = [1, 2, 3]\ncount = 2", "safe", 3, 2),
        ("range = [[0, 1]]\ncount = 2", "range", 1, 2),
        ("parts = [\"x\", \"y\"]\ncount = 3", "parts", 2, 3),
    ] {
        in_effector(
            line,
            Fault::Count,
            key.len() + 4,
            &format!(
                "`{key}` has {given} values for {count} numbers: give it once for all, or once for each"
            ),
        );
    }
    in_effector(
        "range = [1, 2, 3]",
        Fault::Count,
        9,
        "a range is the least and the greatest value, and these are 3 values",
    );
}

#[test]
fn keys_of_other_kinds_are_refused() {
    for (lines, words) in [
        (
            "rate = 1\nkind = \"sensor\"\ntype = \"u8\"",
            "a sensor has no `rate`",
        ),
        (
            "period = 1\nkind = \"effector\"\ntype = \"u8\"",
            "an effector has no `period`",
        ),
        ("lasts = 1\nkind = \"event\"", "an event has no `lasts`"),
        (
            "safe = 1\nkind = \"memory-event\"",
            "a memory event has no `safe`",
        ),
        (
            "type = \"u8\"\nkind = \"monitor\"\nof = \"wheel\"",
            "a monitor has no `type`",
        ),
        (
            "unit = \"mm\"\nkind = \"module\"\nmembers = []",
            "a module has no `unit`",
        ),
        ("members = []\nkind = \"command\"", "a command has no `members`"),
        ("of = \"x\"\nkind = \"event\"", "an event has no `of`"),
        ("max = 3\nkind = \"event\"", "`max` requires `type = \"bytes\"`"),
        (
            "max = 3\nkind = \"event\"\ntype = \"u8\"",
            "`max` is of bytes; how many numbers there are is `count`",
        ),
        (
            "unit = \"mm\"\nkind = \"event\"",
            "`unit` requires a `type` of numbers",
        ),
        (
            "scale = 2\nkind = \"sensor\"\ntype = \"bytes\"\nmax = 5",
            "`scale` applies to numbers, not to bytes",
        ),
        (
            "interpolate = true\nkind = \"effector\"\ntype = \"u8\"\nmotion = \"incremental\"",
            "incremental steps cannot be interpolated: leave out `interpolate` or `motion`",
        ),
    ] {
        in_element(lines, Fault::NotOfKind, (5, 1), words);
    }
}

#[test]
fn a_sound_is_a_codec_and_a_rate_that_it_knows() {
    let speaker = |sound: &str, max: u16| {
        format!("sound = \"{sound}\"\nkind = \"effector\"\ntype = \"bytes\"\nmax = {max}")
    };
    for (sound, max, fault, words) in [
        (
            "pcm",
            2000,
            Fault::UnknownWord,
            "a sound must be a codec and its samples per second, such as `pcm 16000`, not `pcm`",
        ),
        (
            "pmc 16000",
            2000,
            Fault::UnknownWord,
            "there is no codec `pmc`; did you mean `pcm`?",
        ),
        (
            "pcm 44101",
            4000,
            Fault::Number,
            "pcm has 8000 to 96000 samples a second, a multiple of 50, and not `44101`",
        ),
        (
            "opus 44100",
            2000,
            Fault::Number,
            "opus has 8000, 12000, 16000, 24000 or 48000 samples a second, and not `44100`",
        ),
        (
            "pcm 48900",
            1955,
            Fault::Number,
            "20 ms of it take up to 1956 bytes, and `max` is 1955",
        ),
    ] {
        in_element(&speaker(sound, max), fault, (5, 9), words);
    }
    for sound in ["pcm 48900", "opus 48000"] {
        let model = Model::read(&element(&speaker(sound, 1956))).expect(sound);
        assert_eq!(
            model.elements()[0]
                .sound
                .map(|sound| sound.to_string())
                .as_deref(),
            Some(sound)
        );
        assert_eq!(Model::read(&model.to_toml()).as_ref(), Ok(&model));
    }
    in_element(
        "sound = \"pcm 8000\"\nkind = \"event\"\ntype = \"bytes\"\nmax = 500",
        Fault::NotOfKind,
        (5, 1),
        "an event has no `sound`",
    );
    in_element(
        "sound = \"pcm 8000\"\nkind = \"sensor\"\ntype = \"u8\"",
        Fault::NotOfKind,
        (5, 1),
        "`sound` is of bytes; how many numbers there are is `count`",
    );
}

#[test]
fn references_lead_to_elements_of_the_right_kind() {
    let with = |lines: &str| element(&format!("{EFFECTOR}[[element]]\nname = \"other\"\n{lines}"));
    for (lines, place, words) in [
        (
            "kind = \"monitor\"\nof = \"weel\"",
            (10, 6),
            "there is no effector `weel`; did you mean `wheel`?",
        ),
        (
            "kind = \"monitor\"\nof = \"other\"",
            (10, 6),
            "a monitor reports the states of an effector, and `other` is of kind monitor",
        ),
        (
            "kind = \"module\"\nmembers = [\"wheel\", \"nobody\"]",
            (10, 21),
            "there is no element `nobody`; expected `wheel`",
        ),
        (
            "kind = \"module\"\nmembers = [\"wheel\", \"wheel\"]",
            (10, 21),
            "`wheel` is listed twice",
        ),
        (
            "kind = \"module\"\nmembers = [\"other\"]",
            (10, 12),
            "`other` is a module, and a module cannot contain modules",
        ),
        (
            "kind = \"module\"\nmembers = [\"wheel\"]\n[[element]]\nname = \"third\"\nkind = \"module\"\nmembers = [\"wheel\"]",
            (14, 12),
            "`wheel` is a member of another module already",
        ),
    ] {
        check(&with(lines), Fault::Reference, place, words);
    }
}

#[test]
fn more_than_256_elements_are_refused() {
    let mut text = "name = \"x\"\nid = 1\n".to_owned();
    for index in 0..256 {
        text.push_str(&format!("[[element]]\nname = \"e{index}\"\nkind = \"event\"\n"));
    }
    assert_eq!(Model::read(&text).unwrap().map_size(), 32);
    text.push_str("[[element]]\nname = \"last\"\nkind = \"event\"\n");
    check(
        &text,
        Fault::Elements,
        (771, 1),
        "257 elements are too many: a model has at most 256",
    );
}

#[test]
fn a_packet_over_the_limit_is_refused_at_the_element_that_is_too_much() {
    let text = element(
        "kind = \"effector\"\ntype = \"u8\"\ncount = 20\n[[element]]\nname = \"more\"\nkind = \"effector\"\ntype = \"u8\"\ncount = 8",
    );
    // 20 of the header, 1 of the map, 28 of values, and 16 of a tag.
    let limited = |limit: usize| text.replace("id = 7", &format!("id = 7\nlargest-packet = {limit}"));
    assert!(Model::read(&limited(65)).is_ok());
    check(
        &limited(64),
        Fault::Packet,
        (9, 1),
        "a packet to the robot with everything in it has 65 bytes, and `largest-packet` is 64: make it more, or an element smaller",
    );
    // A command cannot travel in fragments.
    let text = element("kind = \"command\"\ntype = \"bytes\"\nmax = 5000");
    check(
        &text,
        Fault::Packet,
        (3, 1),
        "a packet to the robot with everything in it has 5040 bytes, and `largest-packet` is 1472: make it more, or an element smaller",
    );
}

#[test]
fn a_doc_text_has_an_end() {
    let text = element(&format!("kind = \"event\"\ndoc = \"{}\"", "x".repeat(4097)));
    check(
        &text,
        Fault::TooLong,
        (6, 7),
        "a doc text has at most 4096 characters",
    );
}
