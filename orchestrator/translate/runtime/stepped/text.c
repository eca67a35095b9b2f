/* Messages with numbers in them, written as Python writes them. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "stepmodel.h"

void text_add(Text *text, const char *more)
{
    size_t n = strlen(more), left = text->room - text->length - 1;
    if (n > left) n = left;
    memcpy(text->characters + text->length, more, n);
    text->length += n;
    text->characters[text->length] = 0;
}

void text_format(Text *text, const char *format, double value)
{
    char number[400];
    snprintf(number, sizeof number, format, value);
    text_add(text, number);
}

void text_number(Text *text, double value, NumberKind kind)
{
    char number[40];
    int digits = 1, exponent;
    if (kind == NUMBER_BOOL) {
        text_add(text, value != 0 ? "True" : "False");
        return;
    }
    if (!isfinite(value)) {
        text_add(text, isnan(value) ? "nan" : value > 0 ? "inf" : "-inf");
        return;
    }
    if (kind == NUMBER_INT) {
        text_format(text, "%.0f", value);
        return;
    }
    for (;; digits++) {
        snprintf(number, sizeof number, "%.*e", digits - 1, value);
        if (digits == 17 || strtod(number, NULL) == value) break;
    }
    exponent = atoi(strchr(number, 'e') + 1);
    /* From 1e16 on and below 1e-4 Python changes to an exponent. */
    if (exponent >= -4 && exponent < 16) {
        int decimals = digits - 1 - exponent;
        snprintf(number, sizeof number, "%.*f", decimals > 1 ? decimals : 1, value);
    }
    text_add(text, number);
}
