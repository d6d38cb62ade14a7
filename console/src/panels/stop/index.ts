import { define } from "../../element.svelte.js";
import Stop from "./Stop.svelte";
import css from "./stop.css?inline";

define("mom-stop", Stop, css, ["path"]);
