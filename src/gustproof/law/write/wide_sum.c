/* Knuth's sum of two floats: what rounding loses goes to the second one. */
static void add(float *sum, float term)
{
    float total = sum[0] + term, part = total - sum[0];
    sum[1] += (sum[0] - (total - part)) + (term - part);
    sum[0] = total;
}

/* Exact product (Veltkamp and Dekker): the coarse factor and each half of the value have 12 bits. */
static void add_product(float *sum, float coarse, float fine, float value)
{
    float large = 4097.0f * value, high = large - (large - value), low = value - high;
    add(sum, coarse * high);
    add(sum, coarse * low);
    sum[1] += fine * value;
}

static void settle(const float *sum, float *high, float *low)
{
    float total = sum[0] + sum[1];
    *low = sum[1] - (total - sum[0]);
    *high = total;
}
