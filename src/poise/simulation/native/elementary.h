// Exponential, logarithm and normal quantile from +, -, *, / and the square root alone.
//
// IEEE 754 fixes the bits of these, so that a seed gives one run on every machine. libm's
// functions differ in the last bit, by version and by processor.
#pragma once

namespace poise::simulation {

// e^x within 2e-15 of its value; |x| <= 700.
double exponential(double x);

// The natural logarithm within 1e-15 of its value or of 1; x > 0.
double logarithm(double x);

// The quantile of the standard normal distribution; 0 < p < 1. Wichura (1988), "Algorithm
// AS 241", PPND16, as statistics.NormalDist has it.
double normal_quantile(double p);

}  // namespace poise::simulation
