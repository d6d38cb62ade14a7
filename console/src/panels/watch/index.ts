import { define } from "../../element.svelte.js";
import Watch from "./Watch.svelte";
import css from "./watch.css?inline";

define("mom-watch", Watch, css, ["path"]);
