import { define } from "../../element.svelte.js";
import "../connection/index.js";
import "../login/index.js";
import "../status/index.js";
import "../stop/index.js";
import Console from "./Console.svelte";
import css from "./console.css?inline";

define("mom-console", Console, css);
