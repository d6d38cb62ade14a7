//! Tables from files: what is read, and every fault with its place.

use mom_brs::file::{self, EXTENDED, FileFault};
use mom_brs::{Code, Direction, PAPER, Parameter};

/// A command `beep` with more lines.
fn beep(lines: &str) -> String {
    format!("[[command]]\ncode = 20\nname = \"beep\"\n{lines}")
}

/// The fault, its place and its words.
fn fault(text: &str) -> (FileFault, (usize, usize), String) {
    let error = file::table(text).expect_err(text);
    let (line, column) = error.place();
    let words = error.to_string();
    let prefix = format!("line {line}, column {column}: ");
    let words = words.strip_prefix(&prefix).expect("the place comes first");
    (error.fault(), (line, column), words.to_owned())
}

fn check(text: &str, kind: FileFault, place: (usize, usize), words: &str) {
    assert_eq!(fault(text), (kind, place, words.to_owned()), "{text}");
}

#[test]
fn our_own_robots_know_the_papers_commands_and_four_more() {
    let names: Vec<&str> = EXTENDED.commands().iter().map(|command| command.name).collect();
    assert_eq!(
        names,
        ["null", "status", "motor", "leds", "goto", "via", "pose", "holder"]
    );
    for (code, name) in [
        (Code::NULL, "null"),
        (Code::STATUS, "status"),
        (Code::MOTOR, "motor"),
        (Code::LEDS, "leds"),
        (Code::GOTO, "goto"),
        (Code::VIA, "via"),
        (Code::POSE, "pose"),
        (Code::HOLDER, "holder"),
    ] {
        assert_eq!(EXTENDED.get(code).map(|command| command.name), Some(name));
    }
    let holder = EXTENDED.command("holder").unwrap();
    assert!(holder.is_reply_only());
    assert_eq!(holder.length(Direction::Reply), Some(26));
}

#[test]
fn a_file_adds_to_the_papers_commands() {
    let text = beep(
        "parameters = [{ name = \"hertz\", min = 0x14, max = 20_000 }]\nreply = []\nreply-only = false\n",
    );
    let table = file::table(&text).unwrap();
    let (paper, listed) = table.commands().split_at(4);
    assert_eq!(paper, PAPER.commands());
    assert_eq!(listed.len(), 1);
    assert_eq!((listed[0].code.number(), listed[0].name), (20, "beep"));
    assert_eq!(
        listed[0].parameters,
        Some(&[Parameter::new("hertz", 20, 20_000)][..])
    );
    assert_eq!(listed[0].reply, Some(&[][..]));
}

#[test]
fn an_empty_file_is_the_papers_table() {
    assert_eq!(file::table("# nothing\n"), Ok(&PAPER));
}

#[test]
fn a_file_that_is_no_toml_is_refused_at_its_place() {
    let (kind, place, words) = fault("[[command]]\ncode = = 20\n");
    assert_eq!((kind, place), (FileFault::Syntax, (2, 8)), "{words}");
    let (kind, place, words) = fault(&beep("code = 21\n"));
    assert_eq!((kind, place), (FileFault::Syntax, (4, 1)), "{words}");
}

#[test]
fn an_unknown_key_is_refused_with_the_nearest_known() {
    let words =
        "there is no key `replies`; expected one of `code`, `name`, `parameters`, `reply`, `reply-only`";
    check(&beep("replies = []\n"), FileFault::UnknownKey, (4, 1), words);
    let words = "there is no key `reply_only`; did you mean `reply-only`?";
    check(&beep("reply_only = true\n"), FileFault::UnknownKey, (4, 1), words);
    let words = "there is no key `mim`; did you mean `min`?";
    let text = beep("parameters = [{ name = \"x\", mim = 0, max = 1 }]\n");
    check(&text, FileFault::UnknownKey, (4, 29), words);
    let words = "there is no key `comand`; did you mean `command`?";
    check("[[comand]]\n", FileFault::UnknownKey, (1, 3), words);
}

#[test]
fn what_is_missing_is_named() {
    let text = "[[command]]\nname = \"beep\"\n";
    check(text, FileFault::MissingKey, (1, 1), "`code` is missing");
    let text = beep("[[command]]\ncode = 21\n");
    check(&text, FileFault::MissingKey, (4, 1), "`name` is missing");
    let text = beep("reply = [\n  { name = \"x\", min = 0 },\n]\n");
    check(&text, FileFault::MissingKey, (5, 3), "`max` is missing");
}

#[test]
fn a_value_of_another_type_is_refused() {
    for (text, place, words) in [
        (
            "command = 1\n",
            (1, 11),
            "expected a list of tables, found an integer: write `[[command]]`",
        ),
        (
            "command = [1]\n",
            (1, 12),
            "expected a table, found an integer: write `[[command]]`",
        ),
        (
            "[[command]]\ncode = \"20\"\nname = \"x\"\n",
            (2, 8),
            "expected an integer, found a text",
        ),
        (
            "[[command]]\ncode = 20\nname = 5\n",
            (3, 8),
            "expected a text, found an integer",
        ),
    ] {
        check(text, FileFault::Type, place, words);
    }
    let words = "expected true or false, found an integer";
    check(&beep("reply-only = 1\n"), FileFault::Type, (4, 14), words);
    let words = "expected a list of tables, found a text";
    check(&beep("reply = \"x\"\n"), FileFault::Type, (4, 9), words);
}

#[test]
fn a_code_has_two_digits() {
    for number in ["100", "-1", "256", "99999999999999999999"] {
        let (kind, place, words) = fault(&format!("[[command]]\ncode = {number}\nname = \"x\"\n"));
        assert_eq!((kind, place), (FileFault::Code, (2, 8)), "{number}: {words}");
    }
    let words = "100 is not a code: it has two digits, 0 to 99";
    check("[[command]]\ncode = 100\n", FileFault::Code, (2, 8), words);
}

#[test]
fn a_code_is_used_once() {
    let words = "20 is the code of `beep` already";
    let text = beep("[[command]]\ncode = 20\nname = \"boop\"\n");
    check(&text, FileFault::CodeTwice, (5, 8), words);
}

#[test]
fn the_papers_commands_stay_as_they_are() {
    let words = "06 is `motor` of the paper, which every table has";
    check(
        "[[command]]\ncode = 6\nname = \"wheels\"\n",
        FileFault::OfPaper,
        (2, 8),
        words,
    );
    let words = "`motor` is a command of the paper, which every table has";
    check(
        "[[command]]\ncode = 20\nname = \"motor\"\n",
        FileFault::OfPaper,
        (3, 8),
        words,
    );
}

#[test]
fn a_name_is_a_word() {
    for name in ["", "Beep", "1st", "to go", "naïve"] {
        let (kind, place, words) = fault(&format!("[[command]]\ncode = 20\nname = \"{name}\"\n"));
        assert_eq!((kind, place), (FileFault::Name, (3, 8)), "{name}: {words}");
    }
    let words = "\"X\" is not a word: lower-case letters, digits and `-`, a letter first";
    let text = beep("reply = [{ name = \"X\", min = 0, max = 1 }]\n");
    check(&text, FileFault::Name, (4, 19), words);
}

#[test]
fn a_name_is_used_once() {
    let text = beep("[[command]]\ncode = 21\nname = \"beep\"\n");
    check(
        &text,
        FileFault::NameTwice,
        (6, 8),
        "two commands have the name `beep`",
    );
    let one = "{ name = \"x\", min = 0, max = 1 }";
    let text = beep(&format!("parameters = [\n  {one},\n  {one},\n]\n"));
    check(
        &text,
        FileFault::NameTwice,
        (6, 12),
        "two parameters have the name `x`",
    );
    // The same name in a command and in its reply is not a mistake.
    assert!(file::table(&beep(&format!("parameters = [{one}]\nreply = [{one}]\n"))).is_ok());
}

#[test]
fn eight_parameters_are_the_most() {
    let lines = |count: usize| -> String {
        let lines = (0..count).map(|at| format!("  {{ name = \"p{at}\", min = 0, max = 1 }},\n"));
        format!("reply = [\n{}]\n", lines.collect::<String>())
    };
    assert!(file::table(&beep(&lines(8))).is_ok());
    let words = "9 parameters are too many: there may be 8";
    check(&beep(&lines(9)), FileFault::TooMany, (13, 3), words);
}

#[test]
fn a_range_has_values_that_five_characters_hold() {
    let range = |min: &str, max: &str| {
        beep(&format!(
            "reply = [{{ name = \"x\", min = {min}, max = {max} }}]\n"
        ))
    };
    assert!(file::table(&range("-9999", "99999")).is_ok());
    let words = "`x` can have no value: min 2 is more than max 1";
    check(&range("2", "1"), FileFault::Range, (4, 30), words);
    let words = "five characters cannot hold all of `x`: -10000 to 0 is not within -9999 to 99999";
    check(&range("-10000", "0"), FileFault::Range, (4, 30), words);
    let words = "five characters cannot hold all of `x`: 100000 to 100000 is not within -9999 to 99999";
    check(&range("100000", "100000"), FileFault::Range, (4, 30), words);
    for (min, max) in [("0", "100000"), ("0", "99999999999"), ("100000", "100001")] {
        assert_eq!(fault(&range(min, max)).0, FileFault::Range, "{min} to {max}");
    }
}

#[test]
fn what_is_reply_only_has_a_reply_and_no_parameters() {
    let words = "`beep` is reply-only and has no `reply`";
    check(&beep("reply-only = true\n"), FileFault::ReplyOnly, (4, 14), words);
    let words = "`beep` cannot have parameters: base stations never say what is reply-only";
    let text = beep("reply-only = true\nreply = []\nparameters = []\n");
    check(&text, FileFault::ReplyOnly, (4, 14), words);
}

#[test]
fn the_column_is_in_characters() {
    let text = "command = [{ name = \"é\", code = 200 }]\n";
    let (kind, place, _) = fault(text);
    assert_eq!((kind, place), (FileFault::Code, (1, 33)));
}
