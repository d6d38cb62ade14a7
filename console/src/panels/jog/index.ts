import { define } from "../../element.svelte.js";
import Jog from "./Jog.svelte";
import css from "./jog.css?inline";

define("mom-jog", Jog, css, ["device", "camera", "suggested"]);
