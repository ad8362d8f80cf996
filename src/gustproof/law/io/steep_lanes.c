    /* At a steep pitch of one flight each is stepped alone. */
    int steep = 0;
    for (int w = 0; w < ${prefix}_LANES; w++)
        steep |= absolute(x[1][w]) > $steep;
    for (int w = 0; steep && w < ${prefix}_LANES; w++) {
        double own[$rows], seen[$measured], out[3];
        for (int i = 0; i < $rows; i++)
            own[i] = x[i][w];
        for (int i = 0; i < $measured; i++)
            seen[i] = y[i][w];
        (void)${prefix}_step(own, seen, out);
        for (int i = 0; i < $rows; i++)
            x[i][w] = own[i];
        for (int i = 0; i < 3; i++)
            command[i][w] = out[i];
    }
    if (steep)
        return;
