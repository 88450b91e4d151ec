{# The observation in standard deviations from its mean, clipped; C as it stands in a function. #}
{% macro normalise(chosen) %}
{% set mean = out.each("mean", codec.normaliser.mean[chosen], "k") %}
{% set std = out.each("deviation", codec.normaliser.std[chosen], "k") %}
{% set clip = codec.normaliser.clip | c("double") %}
    double x = {{ "observed" if mean == "0.0" else "(observed - " ~ mean ~ ")" }}{{ " / " ~ std if std != "1.0" }};
    if (x > {{ clip }}) {
        x = {{ clip }};
    } else if (x < -{{ clip }}) {
        x = -{{ clip }};
    }
{% endmacro %}
