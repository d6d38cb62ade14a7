//! Threats 4, 5 and 6 inside the forms, through the doors beside TCP: no door makes of what is wrong anything else.

use mom_net::Door;
use mom_proto::codec::Form;
use mom_tests::bridge::Way;

use crate::threats::{After, World, framing, lines, markup};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_6_lengths_in_xml_at_other_doors() {
    for way in Way::beside(Form::Xml) {
        framing::lengths_in_xml(World::start_by(way, Form::Xml).await).await;
        framing::short_and_long(World::start_by(way, Form::Xml).await).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_6_lengths_in_binary_at_other_doors() {
    for way in Way::beside(Form::Binary) {
        framing::lengths_in_binary(World::start_by(way, Form::Binary).await).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_6_lines_at_other_doors() {
    for way in Way::beside(Form::Json) {
        lines::lines(World::start_by(way, Form::Json).await).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_5_encoding_at_other_doors() {
    for way in Way::beside(Form::Json) {
        let after = match way.door {
            Door::WebSocket => After::Closed,
            _ => After::Kept,
        };
        let mut world = World::start_by(way, Form::Json).await;
        lines::encoding_that(&mut world, after).await;
        world.end().await;
    }
    for form in [Form::Xml, Form::Binary] {
        for way in Way::beside(form) {
            markup::encoding(World::start_by(way, form).await).await;
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_4_what_is_kept_of_strangers_at_other_doors() {
    for way in Way::beside(Form::Json) {
        lines::before_login(World::start_by(way, Form::Json).await).await;
    }
    for form in [Form::Xml, Form::Binary] {
        for way in Way::beside(form) {
            framing::kept_before_login(World::start_by(way, form).await).await;
        }
    }
}
