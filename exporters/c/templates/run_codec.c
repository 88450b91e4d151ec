static uint32_t inference;

/* Called by {{ prefix }}_step after each timestep. */
void {{ prefix }}_probe(uint32_t timestep, const {{ id_t }} *id, uint32_t count)
{
    const uint32_t row = inference * {{ PREFIX }}_TIMESTEPS + timestep;
    const uint32_t end = vector_events[row + 1u];
    uint32_t k = vector_events[row];
    uint32_t i;
    compare("the number of input spikes", row, 0u, 0u, (long long)count, (long long)(end - k));
    for (i = 0u; (i < count) && (k < end); i++) {
        compare("an input channel", row, 0u, i, (long long)id[i], (long long)vector_channels[k]);
        k++;
    }
    compare_row(row);
}

static void compare_action(uint32_t a, {{ prefix }}_action_t found, {{ prefix }}_action_t wanted)
{
{% if choices %}
    compare("an action", inference, 0u, a, found, wanted);
{% else %}
    const double size = (wanted < 0.0) ? -wanted : wanted;
    const double apart = (found > wanted) ? (found - wanted) : (wanted - found);
    compare("an action (1: within 1e-12)", inference, 0u, a,
            apart <= (1e-12 * ((size > 1.0) ? size : 1.0)), 1);
{% endif %}
}

static void run(void)
{
    {{ prefix }}_action_t action[{{ PREFIX }}_ACTIONS];
    uint32_t a;
    {{ prefix }}_reset();
    for (inference = 0u; inference < VECTOR_INFERENCES; inference++) {
        const double *observation = &vector_observation[(size_t)inference * {{ PREFIX }}_OBSERVATIONS];
        compare("the result", inference, 0u, 0u, {{ prefix }}_step(observation, action), {{ PREFIX }}_OK);
        for (a = 0u; a < {{ PREFIX }}_ACTIONS; a++) {
            compare_action(a, action[a], ({{ prefix }}_action_t)vector_action[(size_t)inference * {{ PREFIX }}_ACTIONS + a]);
        }
    }
}
