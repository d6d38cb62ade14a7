//! What holds for any text: nothing panics, and what is taken can be written and read again.

use mom_rsp_model::{Direction, Model, generate};

/// Reads any bytes as both kinds of file.
pub(crate) fn any_bytes(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    for read in [Model::read, Model::import_xmi] {
        match read(&text) {
            Ok(model) => holds(&model),
            Err(error) => {
                let (line, column) = error.place();
                assert!(line >= 1 && column >= 1);
                assert!(line <= text.matches('\n').count() + 1, "{error}");
                assert!(error.to_string().len() < 2000);
            }
        }
    }
}

/// What holds for any model.
pub(crate) fn holds(model: &Model) {
    let again = Model::read(&model.to_toml()).expect("what is written is read");
    assert_eq!(&again, model);
    assert_eq!(again.hash(), model.hash());
    for direction in [Direction::Down, Direction::Up] {
        let limit = usize::from(model.largest_packet());
        assert!(model.packet_size(direction) + mom_rsp_model::TAG <= limit);
    }
    let elements = model.wire_elements();
    assert_eq!(model.layout(&elements).id(), model.id());
    assert!(!generate::rust(model).is_empty());
    assert!(!generate::c(model).is_empty());
    assert!(!generate::markdown(model).is_empty());
}
