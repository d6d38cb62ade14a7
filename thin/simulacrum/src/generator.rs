//! Code of a model for peers that ask in a robot's mirror channel, such as the console's modeller, which runs in a browser (S4).

use mom_client::{Family, Map, Parcel, Value};
use mom_rsp_model::{Model, generate};

/// The message that asks for code: `{language, model?}`, the model as TOML; without it, that of the robot.
pub const GENERATE: &str = "generate";
/// The message that answers it, to the asker alone: `{language, name, text}`, or `{language, error}`.
pub const GENERATED: &str = "generated";

/// What is made of a model.
type Make = fn(&Model) -> String;

/// Each language, the ending of its files, and how it is made.
const LANGUAGES: [(&str, &str, Make); 4] = [
    ("rust", "rs", generate::rust),
    ("c", "h", generate::c),
    ("docs", "md", generate::markdown),
    ("toml", "toml", Model::to_toml),
];

/// The answer to a message that asks for code; what is wrong with its model is in it, with line and column. It takes milliseconds of a
/// processor.
pub(crate) fn answer(ask: &Parcel, own: &Model) -> Parcel {
    let content = ask.value();
    let language = content.get("language").and_then(Value::as_str).unwrap_or("rust");
    let told = Map::new().with("language", language);
    let told = match code(language, content.get("model"), own) {
        Ok((name, text)) => told.with("name", name).with("text", text),
        Err(error) => told.with("error", error),
    };
    let mut parcel = Parcel::new(Family::Message, GENERATED).content(told);
    parcel.context.clone_from(&ask.context);
    parcel.reference = ask.id;
    parcel.address = ask.sender.as_deref().map(|sender| vec![sender.into()]);
    parcel
}

/// The name of a file, and what stands in it.
fn code(language: &str, model: Option<&Value>, own: &Model) -> Result<(String, String), String> {
    let Some((_, ending, make)) = LANGUAGES.iter().find(|(word, ..)| *word == language) else {
        let known = LANGUAGES.map(|(word, ..)| word).join(", ");
        return Err(format!("there is no language `{language}`; there are {known}"));
    };
    let read;
    let model = match model {
        None => own,
        Some(Value::String(text)) => {
            read = Model::read(text).map_err(|error| error.to_string())?;
            &read
        }
        Some(_) => return Err("a model is the text of a TOML file".to_owned()),
    };
    Ok((format!("{}.{ending}", model.name()), make(model)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(content: Map) -> Map {
        let mut ask = Parcel::new(Family::Message, GENERATE).content(content);
        (ask.id, ask.sender) = (Some(7), Some("alice".into()));
        let own = Model::read(mom_cubo::MODEL).unwrap();
        let answer = answer(&ask, &own);
        assert_eq!((answer.name(), answer.reference), (GENERATED, Some(7)));
        assert_eq!(answer.address, Some(vec!["alice".into()]));
        match answer.value() {
            Value::Map(map) => map,
            other => panic!("{other:?}"),
        }
    }

    fn text<'m>(map: &'m Map, key: &str) -> &'m str {
        map.get(key).and_then(Value::as_str).unwrap_or_default()
    }

    #[test]
    fn code_is_made_of_the_robots_model_and_of_others() {
        for (language, name, words) in [
            ("rust", "cubo.rs", "pub mod elements {"),
            ("c", "cubo.h", "#define CUBO_"),
            ("docs", "cubo.md", "# "),
            ("toml", "cubo.toml", "sound = \"pcm 48900\""),
        ] {
            let made = asked(Map::new().with("language", language));
            assert_eq!(text(&made, "name"), name);
            assert!(text(&made, "text").contains(words), "{language}");
        }
        let other =
            "name = \"cart\"\nid = 7\n[[element]]\nname = \"wheel\"\nkind = \"effector\"\ntype = \"i16\"\n";
        let made = asked(Map::new().with("language", "c").with("model", other));
        assert_eq!(text(&made, "name"), "cart.h");
    }

    #[test]
    fn mistakes_are_told_with_their_place() {
        let wrong = "name = \"cart\"\nid = 7\nperoid = 20\n";
        for (content, words) in [
            (
                Map::new().with("language", "c").with("model", wrong),
                "line 3, column 1: there is no key `peroid`; did you mean `period`?",
            ),
            (
                Map::new().with("language", "cobol"),
                "there is no language `cobol`; there are rust, c, docs, toml",
            ),
            (
                Map::new().with("language", "c").with("model", 7),
                "a model is the text of a TOML file",
            ),
        ] {
            assert_eq!(text(&asked(content), "error"), words);
        }
    }
}
