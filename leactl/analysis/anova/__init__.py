"""Whether a result differs between conditions: analysis of variance, Tukey's comparisons, effect sizes, a sentence."""
