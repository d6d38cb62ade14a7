import { define } from "../../element.svelte.js";
import "../context/index.js";
import "../tree/index.js";
import "../watch/index.js";
import Contexts from "./Contexts.svelte";
import css from "./contexts.css?inline";

define("mom-contexts", Contexts, css, ["path"]);
