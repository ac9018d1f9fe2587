// A loop of 6 s at 400 Hz: the plant is integrated here, the goal moves after 3 s. Prints every state's bits.
#include "crane.h"
#include <array>
#include <cmath>
#include <cstdio>

using State = std::array<double, CRANE_NX>;

static State plant(const State &x, double u, double h)
{
    const double swing = -(9.81 * std::sin(x[1]) + u * std::cos(x[1]));
    return {x[0] + h * x[2], x[1] + h * x[3], x[2] + h * u, x[3] + h * swing};
}

static crane controller;

int main()
{
    if (crane_create(&controller, sizeof controller) != CRANE_OK)
        return 1;
    const double now = 0.0, goal[CRANE_NX] = {2.0, 0.0, 0.0, 0.0};
    State x{};
    double u[CRANE_NU];
    for (int k = 0; k < 2400; k++) {
        const double t = k / 400.0;
        if (k == 1200)
            crane_set_reference(&controller, CRANE_REFERENCE_STATE, CRANE_KIND_LINEAR, 1, &now, goal);
        if (k % 8 == 0 && crane_update(&controller, t, x.data()) != CRANE_OK)
            return 1;
        if (crane_policy(&controller, t, x.data(), u) != CRANE_OK)
            return 1;
        x = plant(x, u[0], 1.0 / 400.0);
        std::printf("%a %a %a %a\n", x[0], x[1], x[2], x[3]);
    }
    return 0;
}
