// The console shows the same figures as the command line, by the same names.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { load } from "./bundle.mjs";

const { columns, statistics, measured, silence, size, door, figures } = await load("texts/figures.ts");
const rust = (path) => readFileSync(new URL(`../../mom/src/${path}`, import.meta.url), "utf8");

test("the columns of peers are those of mom top", () => {
  const source = rust("top/rows.rs");
  const order = /const COLUMNS[^=]*=\s*\[([^\]]*)\]/.exec(source)[1].match(/Column::\w+/g);
  const heading = /fn heading[\s\S]*?\n    }\n/.exec(source)[0];
  const words = Object.fromEntries([...heading.matchAll(/(Column::\w+) => "([^"]+)"/g)].map(([, column, word]) => [column, word]));
  assert.deepEqual([...columns], order.map((column) => words[column]));
});

test("the statistics are those of mom stats", () => {
  const list = /const HEADINGS[^=]*=\s*\[([^\]]*)\]/.exec(rust("commands/stats.rs"))[1];
  assert.deepEqual([...statistics], [...list.matchAll(/"([^"]+)"/g)].map(([, word]) => word));
});

test("the line of totals has the words of mom top", () => {
  const source = rust("top/rows.rs");
  const line = [figures.connections(9), figures.memory(1024, 2048), figures.memory(1, undefined), figures.traffic(1, 2), figures.messages(3.4, 0)].join("   ");
  assert.equal(line, "9 connections   hub keeps 1.0 KiB of at most 2.0 KiB   hub keeps 1 B   in 1 B/s, out 2 B/s   3 messages/s, 0 dropped/s");
  for (const words of ['"connection"', '"hub keeps {} of at most {}"', '"hub keeps {}"', '"in {}, out {}"', '"{:.0} messages/s, {:.0} dropped/s"']) assert.ok(source.includes(words), words);
  assert.equal(figures.more(4), "and 4 more peers, which the hub does not list");
  assert.ok(source.includes("and {more} more peers, which the hub does not list"));
});

test("units are those of the command line", () => {
  for (const [bytes, words] of [[0, "0 B"], [1023, "1023 B"], [1024, "1.0 KiB"], [12_646, "12.3 KiB"], [1_572_864, "1.5 MiB"], [5e9, "4768.3 MiB"]]) assert.equal(size(bytes), words);
  for (const [ms, words] of [[0.042, "0.04 ms"], [0.42, "0.42 ms"], [9.999, "9.99 ms"], [12.7, "12 ms"], [3560, "3.5 s"]]) assert.equal(measured(ms), words);
  assert.equal(silence(90_400), "1 min 30 s");
  assert.equal(silence(2400), "2.4 s");
  assert.equal(door({ door: "tcp", tls: true, form: "binary" }), "tcp tls binary");
  assert.equal(door({ door: "local", tls: false, form: "none" }), "local");
});
